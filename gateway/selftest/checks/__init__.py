"""The checks, a file each: a function from the bench to its verdicts, in the order in which they are found."""
