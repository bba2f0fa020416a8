"""Re-export until all packages use the new names."""

from .initial_state import static_equilibrium as static_equilibrium
