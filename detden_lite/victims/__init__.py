"""A frozen policy with its critic: where it comes from, and how it is trained."""
