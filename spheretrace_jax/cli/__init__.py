"""The command line `spheretrace`: commands and their output."""
