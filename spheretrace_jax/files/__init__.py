"""Files, on the host: scene text, pictures, and export to other renderers."""
