"""Every rule that decides about effects, rivals, runs, tables and the verdict: from evidence to a decision.

Nothing here simulates or fits, and no other part of the identification is imported. Evidence is a frozen
record of numbers and flags. A number that takes seconds to compute is a function without arguments
(`Measured`), which a rule calls only if the cheaper numbers leave the decision open. A decision against
something is a clause in words that follows "it "; the empty text means that nothing speaks against it.

A constant beside a rule states its meaning, scale and origin, like the fields of `SelectionCriteria`, which
users can change.
"""
