"""User-facing parts: commands, reports, figures, campaigns, benchmark. No block of a Diagram imports them."""
