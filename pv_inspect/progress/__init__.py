"""How far a run is, in a terminal and in a notebook."""
