"""Whether a result can be used: noise, misfit and structure of residuals, and the verdict of each job."""
