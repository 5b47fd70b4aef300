"""Alternate experiments and diagnoses on a live board until one cause is left: `board51 investigate`.

Reading order: `decide` (the next step and its reason; pure), `journal` (the steps so far, to continue later), `work`
(the commands as processes), `investigator` (the loop).  The package does not import the twin: it runs `board51 campaign
run` and `board51 diagnose`.
"""
