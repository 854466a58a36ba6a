"""The window of `spheretrace view`: a session, its frames, and the server of its page."""
