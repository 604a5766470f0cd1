"""The command line ``pv-inspect``."""
