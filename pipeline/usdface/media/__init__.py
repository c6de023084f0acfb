"""Video, images, rendering and contact sheets."""
