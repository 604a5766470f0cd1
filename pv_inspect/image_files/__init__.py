"""Image files read with care: what a file claims is checked before memory is taken for it."""
