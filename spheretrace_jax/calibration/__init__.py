"""From photographs of a ball to its place and to the directions of light (host side, NumPy)."""
