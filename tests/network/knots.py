"""Knots: robots that choose their turn late and stop inside crossings, and that can leave by no turn."""

from itertools import combinations, product

import networkx as nx

from elitelanes_jax.lanes.movements import lane_graph
from elitelanes_jax.network.codes import CONNECTIONS


def read_slots(codes):
    """Returns the slots of a network, and for each heading of a robot there, the slots that it may turn to.

    Other tiles have a slot in each heading. A crossing is one slot.
    """
    graph = lane_graph(codes)
    nodes = list(zip(graph.nodes.row.tolist(), graph.nodes.column.tolist(), graph.nodes.heading.tolist(), strict=True))
    slots = [
        (row, column) if CONNECTIONS[codes[row, column]] > 2 else (row, column, heading)
        for row, column, heading in nodes
    ]
    turns = {slot: {} for slot in slots}
    for start, end in graph.edges.tolist():
        turns[slots[start]].setdefault(nodes[start][2], set()).add(slots[end])
    return turns


def smallest_knot(turns):
    """Returns the fewest robots, each with a slot and a heading, whose turns all lead to slots of these robots."""
    fewest = len(turns) + 1

    def close(chosen, waiting):
        """Chooses the headings of robots in the waiting slots, and adds the slots that these lead to."""
        nonlocal fewest
        if len(chosen | waiting) >= fewest:
            return
        if not waiting:
            fewest = len(chosen)
            return
        slot = min(waiting, key=lambda slot: len(turns[slot]))
        for onward in turns[slot].values():
            close(chosen | {slot}, (waiting | onward) - chosen - {slot})

    for slot in turns:
        close(frozenset(), frozenset([slot]))
    return fewest


def smallest_knot_of_all_states(turns):
    """The same, by a look at all states of a small network."""
    for robots in range(1, len(turns) + 1):
        for slots in combinations(turns, robots):
            for onward in product(*(turns[slot].values() for slot in slots)):
                if set().union(*onward) <= set(slots):
                    return robots
    return len(turns) + 1


def smallest_closed_part(turns):
    """Returns the size of the smallest part of the network that no robot can leave."""
    graph = nx.DiGraph([(slot, end) for slot, of in turns.items() for onward in of.values() for end in onward])
    parts = nx.condensation(graph)
    return min(len(parts.nodes[part]["members"]) for part in parts if not parts.out_degree(part))
