"""Reports as one HTML file that opens anywhere: no network, no other files.

A report is a list of `Section`s; a command builds those that it has something to say about, and `page` puts
them together.
"""

from diagrams.html_report.comparison_sections import check_same_pushes, comparison_sections
from diagrams.html_report.diagnosis_sections import diagnosis_sections, reading_section
from diagrams.html_report.page import Section, page

__all__ = [
    "Section",
    "check_same_pushes",
    "comparison_sections",
    "diagnosis_sections",
    "page",
    "reading_section",
]
