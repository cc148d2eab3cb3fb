"""Results of a fit: files that other tools open, pictures and plots."""
