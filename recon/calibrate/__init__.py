"""Find cameras from pictures of a board or from a video, and plan where to put them."""
