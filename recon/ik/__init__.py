"""Inverse kinematics of serial chains: of an animal's limbs, of robots' legs and arms (docs/ik.md)."""
