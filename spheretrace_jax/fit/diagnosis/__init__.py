"""Diagnosis of a fit: trust, uncertainty, and what the pictures do not determine."""
