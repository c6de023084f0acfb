"""Reading and writing of movies, image sequences and sound."""
