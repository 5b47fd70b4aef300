"""Estimates without the likelihood: where a fit starts, and what checks it afterwards."""
