"""What is measured and judged: the paper's experiment, steps, criteria."""
