"""What people use: commands, reports, figures, campaigns, the benchmark. No block of a Diagram imports it."""
