"""Describe robots, retarget an animal's motion to them, check it with physics, and plan climbs (docs/robot.md)."""
