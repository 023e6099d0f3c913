"""Results in the forms of other tools: coefficients for their formulas, samples for their readers."""
