"""What is done with results: sweeps, charts, maps of where methods fail, recommendations, the report. Never loads dolfinx."""
