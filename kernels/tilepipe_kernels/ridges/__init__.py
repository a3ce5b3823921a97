"""Ridge lines after Steger (1998): points, links, widths."""
