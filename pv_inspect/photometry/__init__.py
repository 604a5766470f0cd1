"""What lies between the light of the module and the numbers of a frame."""
