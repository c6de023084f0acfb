"""Learning one set of numbers from another: references in, predictions out."""
