"""What a command reports: words, tables on the terminal, and pages of HTML that open anywhere."""
