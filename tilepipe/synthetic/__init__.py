"""A procedural city with known truth, of any size, for demonstrations, tests and benchmarks.

Every pixel is a function of the city's parameters and the pixel's global row and column, so a window looks
the same however the city is cut.
"""

from tilepipe.synthetic.city import City
from tilepipe.synthetic.layers import LAYERS, render, render_layers
from tilepipe.synthetic.truth import truth_buildings, truth_centerlines
from tilepipe.synthetic.write import write_city

__all__ = ["LAYERS", "City", "render", "render_layers", "truth_buildings", "truth_centerlines", "write_city"]
