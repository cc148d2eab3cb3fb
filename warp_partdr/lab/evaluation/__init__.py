"""Methods side by side on people of known truth: data sets, scores, reports, PartBench."""
