"""The pages that a person reads: report, validation, diagnosis, and changes of weights.

templates   the one Jinja environment; a page is a list of sections, each a module beside its template
units       figures and units as a person writes them
words       a diagnosis in words, for its page and for the terminal
figures     drawings, as SVG that stands in the page
summary     several studies side by side, for the report and for the terminal
"""
