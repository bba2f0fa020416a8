"""Source of a machine's formulas in the languages of controllers, traced from the equations of motion."""
