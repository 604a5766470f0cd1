"""Qt widgets that know nothing of solar modules."""
