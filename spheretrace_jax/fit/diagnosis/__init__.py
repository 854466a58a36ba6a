"""What a fit is worth: trust, uncertainty, and what the pictures do not determine."""
