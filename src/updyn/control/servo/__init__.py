"""The servo loop on a plant: controller, loop functions, margins, time responses, drive figures."""
