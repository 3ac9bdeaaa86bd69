"""A frozen policy with its critic: where it comes from, and its gradients."""
