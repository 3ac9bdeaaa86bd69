"""What people look at: figures, widgets, films and recordings."""
