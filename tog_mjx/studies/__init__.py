"""Beyond one run: landscapes, studies with statistics, and what things cost."""
