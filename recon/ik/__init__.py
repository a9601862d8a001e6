"""Solve inverse kinematics of serial chains, such as an animal's limbs and robots' legs and arms (docs/ik.md)."""
