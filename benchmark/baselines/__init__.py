"""Plain methods for comparison. Each is one file of NumPy."""
