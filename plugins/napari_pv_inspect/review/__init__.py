"""The review of the cells: its state, where it is kept, what is shown."""
