"""The real arm, or its twin in another process, and what keeps it from doing harm."""
