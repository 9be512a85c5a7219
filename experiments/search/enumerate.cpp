// Lists all flawless networks of a grid whose cells may be empty, one by one, and prints a line for each niche:
// cyclomatic number, turns, straights, the number of networks, and the highest straight score of a network without
// bridges, -1 if there is none.
//
//     g++ -O3 -march=native -std=c++20 enumerate.cpp -o enumerate && ./enumerate HEIGHT WIDTH
//
// It shares no code with the exact programmes. It joins no states: each network is a leaf of the recursion. A network
// that improves a niche is measured again as a graph.

#include <array>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <vector>

namespace {

constexpr int kMost = 8;
int height, width;
int grid[kMost][kMost];  // 8 north + 4 east + 2 south + 1 west

struct Niche {
  long long networks = 0;
  int best = -1;
};
Niche niches[32][64][64];

// What the cells so far share with the next ones. Index `width` of `label` is the link to the right.
struct Border {
  std::array<unsigned char, kMost + 1> label{};  // of each link that crosses the border, 0 without one
  std::array<unsigned char, kMost> column_run{};  // straights in a row that end above
  int row_run = 0;
  int cycles = 0, turns = 0, straights = 0, score = 0;
};

bool is_turn(int code) { return code == 3 || code == 6 || code == 9 || code == 12; }
bool is_crossing(int code) { return __builtin_popcount(code) >= 3; }

void fail(const char* text) {
  std::fprintf(stderr, "enumerate: %s\n", text);
  std::exit(1);
}

// Returns the number of bridges of the network in `grid`, and checks that it is connected and has `cycles` cycles.
int count_bridges(int cycles) {
  std::vector<int> order(height * width, -1), low(height * width);
  int found = 0, edges = 0, tiles = 0, bridges = 0;
  const auto visit = [&](const auto& self, int node, int parent) -> void {
    order[node] = low[node] = found++;
    const int code = grid[node / width][node % width];
    const int step[4] = {-width, 1, width, -1}, side[4] = {8, 4, 2, 1};
    for (int k = 0; k < 4; k++) {
      if (!(code & side[k])) continue;
      const int next = node + step[k];
      if (!(grid[next / width][next % width] & side[(k + 2) % 4])) fail("a link without an end");
      edges++;
      if (next == parent) continue;
      if (order[next] < 0) {
        self(self, next, node);
        bridges += low[next] > order[node];
        low[node] = std::min(low[node], low[next]);
      } else {
        low[node] = std::min(low[node], order[next]);
      }
    }
  };
  for (int node = 0; node < height * width; node++) {
    if (!grid[node / width][node % width]) continue;
    if (!tiles++) visit(visit, node, -1);
  }
  if (found != tiles || edges / 2 - tiles + 1 != cycles) fail("a network that is not what it should be");
  return bridges;
}

void finish(const Border& border) {
  Niche& niche = niches[border.cycles][border.turns][border.straights];
  niche.networks++;
  if (border.score > niche.best && !count_bridges(border.cycles)) niche.best = border.score;
}

void place(int cell, const Border& before) {
  if (cell == height * width) return;  // without roads
  const int row = cell / width, column = cell % width;
  const int up = before.label[column], left = column ? before.label[width] : 0;
  const int above = row ? grid[row - 1][column] : 0, beside = column ? grid[row][column - 1] : 0;
  for (int links = 0; links < 4; links++) {
    const int right = links >> 1, down = links & 1;
    if ((right && column == width - 1) || (down && row == height - 1)) continue;
    const int code = 8 * (up > 0) + 4 * right + 2 * down + (left > 0);
    if (__builtin_popcount(code) == 1) continue;
    if (is_turn(code) && (is_turn(above) || is_turn(beside))) continue;
    if (is_crossing(code) && ((up && is_crossing(above)) || (left && is_crossing(beside)))) continue;
    Border after = before;
    grid[row][column] = code;
    after.row_run = code == 5 ? (column ? before.row_run : 0) + 1 : 0;
    after.column_run[column] = code == 10 ? before.column_run[column] + 1 : 0;
    if (code == 5) after.score += 2 * after.row_run - 1;
    if (code == 10) after.score += 2 * after.column_run[column] - 1;
    after.straights += code == 5 || code == 10;
    after.turns += is_turn(code);
    after.label[column] = after.label[width] = 0;
    if (!code) {
      place(cell + 1, after);
      continue;
    }
    int own = up ? up : left;
    if (!own) {  // the lowest label that no link has
      bool taken[kMost + 3] = {};
      for (int k = 0; k <= width; k++) taken[after.label[k]] = true;
      for (own = 1; taken[own];) own++;
    }
    if (up && left && up == left) after.cycles++;
    if (up && left && up != left)
      for (auto& label : after.label)
        if (label == left) label = up;
    if (down) after.label[column] = own;
    if (right) after.label[width] = own;
    bool open = false, others = false;
    for (int k = 0; k <= width; k++) {
      open |= after.label[k] == own;
      others |= after.label[k] && after.label[k] != own;
    }
    if (open) place(cell + 1, after);
    if (open || others) continue;
    // Nothing crosses the border: the network is complete, and all further cells are empty.
    for (int rest = cell + 1; rest < height * width; rest++) grid[rest / width][rest % width] = 0;
    finish(after);
  }
  grid[row][column] = 0;
}

}  // namespace

int main(int count, char** arguments) {
  height = count > 2 ? std::atoi(arguments[1]) : 0;
  width = count > 2 ? std::atoi(arguments[2]) : 0;
  if (height < 2 || width < 2 || height > kMost || width > kMost) fail("expected a height and a width of 2 to 8");
  place(0, Border{});
  for (int cycles = 0; cycles < 32; cycles++)
    for (int turns = 0; turns < 64; turns++)
      for (int straights = 0; straights < 64; straights++)
        if (const Niche& niche = niches[cycles][turns][straights]; niche.networks)
          std::printf("%d %d %d %lld %d\n", cycles, turns, straights, niche.networks, niche.best);
}
