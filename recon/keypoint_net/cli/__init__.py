"""The commands of the keypoint network, one module each."""
