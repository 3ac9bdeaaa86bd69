"""The stages that make data/, their sizes, and the command line."""
