"""How fluids age: results of single clutches, calibrations, what is usual in the fleet, and prognoses."""
