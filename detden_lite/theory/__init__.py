"""Appendix A of the paper: its bound, MDPs small enough to check it, and the largest error of a denoiser."""
