"""The least-squares problem of a fit, for one picture or for several of one world."""
