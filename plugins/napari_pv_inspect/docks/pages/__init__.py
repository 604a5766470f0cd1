"""The pages of the dock *Inspect module*, one for each task."""
