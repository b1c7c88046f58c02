"""Commands about data and the installation: `datasets`, `demo`, `doctor`, `prove`, `study`."""
