"""EllipBody, its template, and the skeleton and label tables."""
