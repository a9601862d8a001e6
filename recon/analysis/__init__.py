"""Functions of a reconstruction: what it says, and how good it is."""
