"""Results of a fit: files for other tools, pictures and plots."""
