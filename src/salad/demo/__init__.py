"""The whole road on a drawn town, and the page that shows it."""
