"""The discrete problem: spaces, data, facet conditions, KKT residuals, contact sets."""
