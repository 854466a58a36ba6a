"""What everything else rests on: array types, vectors, safe mathematics, errors."""
