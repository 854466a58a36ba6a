"""Scenes: objects, lights and camera, the settings of a picture, and what the picture needs."""
