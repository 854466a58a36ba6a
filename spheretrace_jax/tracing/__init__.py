"""The lecture's ray tracing: so far its plain form, to be read beside the slides."""
