"""The frames: found on disk, checked, read, and what the sensor did to them."""
