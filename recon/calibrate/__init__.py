"""Find cameras from pictures of a board or from a video, and advise where to put cameras."""
