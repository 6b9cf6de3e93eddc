"""One offline page that explains runs: the answer, the table, and every scan's choice."""
