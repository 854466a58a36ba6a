"""Files: scenes and pictures, read and written on the host."""
