// The paper's fitness of grids of tile codes, one after another: Tarjan's depth-first search with a stack of its own.
// A baseline for the kernels; `baselines.py` compiles and calls it.

#include <algorithm>
#include <cstdint>
#include <vector>

namespace {

constexpr int kNorth = 8, kEast = 4, kSouth = 2, kWest = 1;
constexpr int kBits[4] = {kNorth, kEast, kSouth, kWest};
constexpr int kBacks[4] = {kSouth, kWest, kNorth, kEast};
constexpr int kConnections[16] = {0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4};

bool is_turn(int code) { return code == 3 || code == 6 || code == 9 || code == 12; }

int squares_of_runs(const int8_t* first, int count, int stride, int straight) {
  int sum = 0, run = 0;
  for (int index = 0; index < count; ++index) {
    if (first[index * stride] == straight) {
      ++run;
    } else {
      sum += run * run;
      run = 0;
    }
  }
  return sum + run * run;
}

class Search {
 public:
  Search(int height, int width)
      : height_(height), width_(width), steps_{-width, 1, width, -1}, nodes_(height * width), stack_(height * width) {}

  int32_t fitness(const int8_t* grid) {
    int tiles = 0, links = 0, dead_ends = 0, violations = 0, pairs = 0, turns = 0, straight = 0;
    for (int row = 0, cell = 0; row < height_; ++row) {
      for (int column = 0; column < width_; ++column, ++cell) {
        const int code = grid[cell];
        // The sides on which a neighbour answers; found in advance, the search itself needs no bounds.
        const int inside = (row > 0) * kNorth | (column + 1 < width_) * kEast | (row + 1 < height_) * kSouth |
                           (column > 0) * kWest;
        int answered = 0;
        for (int side = 0; side < 4; ++side) {
          if ((code & inside & kBits[side]) && (grid[cell + steps_[side]] & kBacks[side])) answered |= kBits[side];
        }
        nodes_[cell] = {-1, 0, -1, static_cast<int8_t>(answered), 0};
        tiles += code != 0;
        violations += (code & ~inside) != 0;
        dead_ends += code != 0 && (answered != code || kConnections[code] == 1);
        for (const int side : {1, 2}) {
          if (!(inside & kBits[side])) continue;
          const int other = grid[cell + steps_[side]];
          const bool linked = answered & kBits[side];
          links += linked;
          pairs += linked && kConnections[code] >= 3 && kConnections[other] >= 3;
          turns += is_turn(code) && is_turn(other);
        }
      }
    }
    for (int row = 0; row < height_; ++row) straight += squares_of_runs(grid + row * width_, width_, 1, 5);
    for (int column = 0; column < width_; ++column) straight += squares_of_runs(grid + column, height_, width_, 10);
    int components = 0, bridges = 0, time = 0;
    for (int start = 0; start < height_ * width_; ++start) {
      if (grid[start] != 0 && nodes_[start].found < 0) {
        ++components;
        bridges += explore(start, time);
      }
    }
    const int cyclomatic = links - tiles + components;
    return 480 * dead_ends + 300 * std::max(components - 1, 0) + 150 * violations + 100 * bridges + 200 * pairs +
           80 * turns - 2 * cyclomatic - 2 * straight;
  }

 private:
  struct Node {
    int32_t found, low, parent;
    int8_t answered, side;
  };

  int explore(int start, int& time) {
    int bridges = 0, top = 0;
    stack_[0] = start;
    nodes_[start].found = nodes_[start].low = time++;
    while (top >= 0) {
      const int here = stack_[top];
      Node& node = nodes_[here];
      if (node.side == 4) {
        --top;
        if (node.parent >= 0) {
          Node& above = nodes_[node.parent];
          above.low = std::min(above.low, node.low);
          bridges += node.low > above.found;
        }
        continue;
      }
      const int side = node.side++;
      if (!(node.answered & kBits[side])) continue;
      const int there = here + steps_[side];
      Node& next = nodes_[there];
      if (next.found < 0) {
        next.found = next.low = time++;
        next.parent = here;
        stack_[++top] = there;
      } else if (there != node.parent) {
        node.low = std::min(node.low, next.found);
      }
    }
    return bridges;
  }

  int height_, width_, steps_[4];
  std::vector<Node> nodes_;
  std::vector<int32_t> stack_;
};

}  // namespace

extern "C" void fitness(const int8_t* grids, int32_t* result, int64_t count, int64_t height, int64_t width) {
  Search search(height, width);
  for (int64_t index = 0; index < count; ++index) result[index] = search.fitness(grids + index * height * width);
}
