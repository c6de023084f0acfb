"""Arrays in, arrays out: the mathematics, one method a file."""
