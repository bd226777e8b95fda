"""Reports of commands: words, tables on the terminal, and HTML pages that any browser opens."""
