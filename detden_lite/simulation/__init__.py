"""Worlds of one task stepped together, planning in them, and rollouts."""
