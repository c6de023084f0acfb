"""Where a performer's markers sit on a face, as their labels say."""
