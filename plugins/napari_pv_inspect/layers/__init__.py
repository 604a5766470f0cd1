"""The layers of the workbench, each updated from the model by its own module."""
