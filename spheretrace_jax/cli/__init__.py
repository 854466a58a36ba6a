"""The command line `spheretrace`."""
