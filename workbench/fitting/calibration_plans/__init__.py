"""Which stages and effects a calibration estimates: the default plan, plans from files, and tests of their stages."""
