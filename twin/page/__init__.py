"""What the reports share: a base template with its stylesheet, one style of figures."""
