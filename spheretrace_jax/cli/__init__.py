"""The command line `spheretrace`: commands, reports and progress."""
