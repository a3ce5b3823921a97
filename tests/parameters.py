"""Parameters of the pipelines from named values, checked as those of a command line are."""

from __future__ import annotations

from functools import partial

from tilepipe.engine.parameters import checked_parameters
from tilepipe.pipelines.edges.parameters import EdgeParameters
from tilepipe.pipelines.objects.parameters import ObjectParameters
from tilepipe.pipelines.streets.parameters import StreetParameters

street_parameters = partial(checked_parameters, StreetParameters)
object_parameters = partial(checked_parameters, ObjectParameters)
edge_parameters = partial(checked_parameters, EdgeParameters)
