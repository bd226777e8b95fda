"""The real arm, or its twin in another process, and the guard that keeps it from doing harm."""
