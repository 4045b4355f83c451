"""What design finds as plots, and how these become pictures."""
