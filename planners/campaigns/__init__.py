"""Campaigns: many trials of one experiment, spread over processes or machines, and the tables they give."""
