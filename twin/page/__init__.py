"""The common parts of the reports: a base template with its stylesheet, one style of figures."""
