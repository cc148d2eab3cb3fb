"""What a fit leaves behind: files that other tools open, pictures and plots."""
