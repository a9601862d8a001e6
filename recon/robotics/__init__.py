"""Robots: their legs, retargeting of an animal's motion, physics, climbing (docs/robot.md, docs/climb.md)."""
