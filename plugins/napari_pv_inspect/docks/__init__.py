"""The docks of the workbench: thin views of the model."""
