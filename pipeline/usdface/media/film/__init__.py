"""Movies, image sequences and sound, read and written."""
