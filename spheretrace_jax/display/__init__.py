"""What people see: progress, pictures in notebooks, pages."""
