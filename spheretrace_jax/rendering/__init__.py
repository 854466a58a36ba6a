"""From a scene to a picture: strips of pixels, samples, the pixel filter, secondary rays."""
