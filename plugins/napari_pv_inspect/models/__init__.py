"""State of the workbench without Qt: what is known, set, edited and undone."""
