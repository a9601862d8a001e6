"""What an animal's motion says: kinematics, stances, strides, phase portraits, and comparison with a truth."""
