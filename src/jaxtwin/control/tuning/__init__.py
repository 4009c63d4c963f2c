"""Parameters and references found for a controller: by derivatives of its loops, by a relay's
oscillation, and by the gain of the plate at rest."""
