"""Which frames show the same module, and which module a sequence is about."""
