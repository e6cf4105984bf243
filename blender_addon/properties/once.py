"""How the options of operators behave."""

# An operator's own options hold for one call only; what is left open comes from the scene.
ONCE = {"SKIP_SAVE"}
