"""The layers of the workbench, each kept in step with the model by its own small file."""
