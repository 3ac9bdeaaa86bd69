"""Files of data/: written whole or not at all, with SHA-256 sums; tensors, and the models made of them."""
