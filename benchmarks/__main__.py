"""The command line of the benchmarks: ``python -m benchmarks kernels``, or a pipeline's name, or ``memory``."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from tilepipe.engine.tiles.allocator import keep_freed_memory


def main() -> None:
    """Parse the arguments and run."""
    # as the command line does; one heap for all threads also lets the harness see what a call needs
    keep_freed_memory()
    parser = argparse.ArgumentParser(prog="bench", description="Speed and quality beside the named peers.")
    commands = parser.add_subparsers(dest="command", required=True)
    kernels = commands.add_parser("kernels", help="each kernel and the engine beside their peers")
    kernels.add_argument("--only", default="", help="cases whose name holds this text; no page")
    streets = commands.add_parser("streets", help="the streets pipeline from end to end")
    streets.add_argument("--steps", type=int, default=50, help="diffusion steps")
    objects = commands.add_parser("objects", help="the objects pipeline from end to end, and its parts")
    objects.add_argument(
        "--scenes", nargs="+", choices=("city", "amsterdam", "montpellier"), help="some; all by default"
    )
    objects.add_argument("--nodes", type=int, nargs="+", help="sizes of the samplers' graphs")
    objects.add_argument("--only", choices=("pipeline", "samplers", "kernels"), help="one part; no page")
    objects.add_argument("--data", type=Path, help="folder of the real surveys")
    edges = commands.add_parser("edges", help="the edges pipeline from end to end, its optimisers and lines")
    edges.add_argument("--scenes", nargs="+", choices=("city", "photograph"), help="some; all by default")
    edges.add_argument("--only", choices=("optimisers", "lines", "pipeline"), help="one part; no page")
    edges.add_argument("--data", type=Path, help="folder of the photograph and of the Potts energy")
    memory = commands.add_parser("memory", help="peak memory on the worst contents beside the plan")
    memory.add_argument("--tile", type=int, nargs="+", default=[1024], help="sides of the tiles in pixels")
    memory.add_argument("--pipelines", nargs="+", choices=("streets", "objects", "edges"), help="all by default")
    memory.add_argument("--workers", type=int, nargs="+", default=[2], help="numbers of workers")
    memory.add_argument("--executors", nargs="+", choices=("threads", "processes"), default=["threads", "processes"])
    memory.add_argument("--contents", nargs="+", help="contents whose names begin with these texts; all by default")
    for command in (kernels, streets, objects, edges, memory):
        command.add_argument("--size", type=int, nargs="+", help="side of the scene in pixels; several for pipelines")
        command.add_argument("--quick", action="store_true", help="a small scene, few rounds, no page: under a minute")
        command.add_argument("--rounds", type=int, help="repetitions after the warm-up")
        command.add_argument("--no-peers", action="store_true", help="measure tilepipe alone; no page")
        command.add_argument("--scratch", type=Path, help="folder for temporary files")
    arguments = parser.parse_args()
    # a part of the cases, or of the work, is no page to cite
    partial = arguments.quick or arguments.no_peers or getattr(arguments, "only", "")
    page: dict[str, Any] = {"results": None} if partial else {}
    if arguments.command == "kernels":
        from benchmarks.kernels.page import ENGINE_SIZE, QUICK_SIZE, SIZE, run_kernels

        run_kernels(
            size=arguments.size[0] if arguments.size else QUICK_SIZE if arguments.quick else SIZE,
            engine_size=2048 if arguments.quick else ENGINE_SIZE,
            repetitions=arguments.rounds or (2 if arguments.quick else 3),
            peers=not arguments.no_peers,
            patience=0.5 if arguments.quick else 20.0,
            only=arguments.only,
            scratch=arguments.scratch,
            **page,
        )
    elif arguments.command == "objects":
        from benchmarks.objects import page as benchmark

        if arguments.quick:
            page |= {"kernel_size": benchmark.QUICK_KERNEL_SIZE, "updates": benchmark.QUICK_UPDATES}
        chosen = {"scenes": arguments.scenes, "nodes": arguments.nodes, "data": arguments.data}
        if arguments.quick:
            chosen["nodes"] = arguments.nodes or benchmark.QUICK_NODES
            chosen["scenes"] = arguments.scenes or ["city"]
        benchmark.run_objects(
            sizes=arguments.size or [benchmark.QUICK_SIZE if arguments.quick else benchmark.SIZE],
            parts=[arguments.only] if arguments.only else benchmark.PARTS,
            repetitions=arguments.rounds or (1 if arguments.quick else 3),
            peers=not arguments.no_peers,
            scratch=arguments.scratch,
            **{name: value for name, value in chosen.items() if value is not None},
            **page,
        )
    elif arguments.command == "edges":
        _run_edges(arguments, page)
    elif arguments.command == "memory":
        from benchmarks.memory import page as benchmark_of_memory
        from tilepipe.pipelines import registry

        benchmark_of_memory.run_memory(
            sizes=arguments.size or [benchmark_of_memory.QUICK_SIZE if arguments.quick else benchmark_of_memory.SIZE],
            tiles=arguments.tile,
            pipelines=arguments.pipelines or registry.OWN,
            workers=arguments.workers,
            executors=arguments.executors,
            contents=[
                name for name in benchmark_of_memory.CONTENTS if name.startswith(tuple(arguments.contents or [""]))
            ],
            scratch=arguments.scratch,
            **page,
        )
    else:
        from benchmarks.streets.page import QUICK_SIZE, SIZE, run_streets

        run_streets(
            sizes=arguments.size or [QUICK_SIZE if arguments.quick else SIZE],
            steps=arguments.steps,
            repetitions=arguments.rounds or (1 if arguments.quick else 3),
            peers=not arguments.no_peers,
            scratch=arguments.scratch,
            **page,
        )


def _run_edges(arguments: argparse.Namespace, page: dict[str, Any]) -> None:
    from benchmarks.edges import page as benchmark

    chosen = {"scenes": arguments.scenes, "data": arguments.data}
    sizes = {"sizes": arguments.size}
    if arguments.size:
        # one size for all parts, as far as they have so many pixels
        largest = max(arguments.size)
        sizes |= {"image_size": largest, "accuracy_size": min(largest, benchmark.ACCURACY_SIZE)}
    elif arguments.quick:
        sizes = {
            "sizes": [benchmark.QUICK_SIZE],
            "image_size": benchmark.QUICK_IMAGE_SIZE,
            "accuracy_size": benchmark.QUICK_ACCURACY_SIZE,
        }
    if arguments.quick:
        chosen |= {"sweeps": benchmark.QUICK_SWEEPS, "scenes": arguments.scenes or ["city"]}
    benchmark.run_edges(
        parts=[arguments.only] if arguments.only else benchmark.PARTS,
        repetitions=arguments.rounds or (1 if arguments.quick else 3),
        peers=not arguments.no_peers,
        scratch=arguments.scratch,
        **{name: value for name, value in (chosen | sizes).items() if value is not None},
        **page,
    )


if __name__ == "__main__":
    main()
