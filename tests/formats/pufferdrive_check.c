// Loads maps in PufferDrive's core without a window, and prints a line of JSON for each.
//
//     pufferdrive_check STEPS MAP...
//
// A line has the links that PufferDrive finds between lanes, the place and heading of each car at the start, how many
// cars are off the road or touch another there, at PufferDrive's size of cars (0.7 of the map's) and at full size, and
// how many are in no lane. Then all cars take STEPS random actions.

#include "drive_core.h"

enum { MOST_LINKS = 64, ACCELERATIONS = 7, STEERINGS = 13 };
static const float SHRUNK = 0.7f;

typedef struct { int off_road, touching, laneless; } Faults;

static void start(Drive *env, char *map) {
    memset(env, 0, sizeof *env);
    env->map_name = map;
    env->dynamics_model = CLASSIC;
    env->goal_behavior = GOAL_GENERATE_NEW;
    env->goal_radius = 2;
    env->dt = 0.1f;
    env->scenario_length = 91;
    env->init_mode = INIT_ALL_VALID;
    env->control_mode = CONTROL_VEHICLES;
    allocate(env);
    c_reset(env);
}

static void print_links(Drive *env) {
    const char *comma = "";
    printf("\"links\": [");
    for (int lane = 0; lane < env->num_entities; lane++) {
        if (env->entities[lane].type != ROAD_LANE) continue;
        int next[MOST_LINKS];
        int count = getNextLanes(env->topology_graph, lane, next, MOST_LINKS);
        for (int i = 0; i < count; i++) {
            printf("%s[%d, %d]", comma, lane - env->num_objects, next[i] - env->num_objects);
            comma = ", ";
        }
    }
    printf("]");
}

static void print_cars(Drive *env) {
    printf(", \"cars\": [");
    for (int i = 0; i < env->active_agent_count; i++) {
        Entity *car = &env->entities[env->active_agent_indices[i]];
        printf("%s[%g, %g, %g]", i ? ", " : "", car->x + env->world_mean_x, car->y + env->world_mean_y, car->heading);
    }
    printf("]");
}

static Faults find_faults(Drive *env, float scale) {
    Faults faults = {0};
    for (int i = 0; i < env->active_agent_count; i++) {
        int index = env->active_agent_indices[i];
        Entity *car = &env->entities[index];
        car->width *= scale;
        car->length *= scale;
        compute_agent_metrics(env, index);
        faults.off_road += car->collision_state == OFFROAD;
        faults.touching += car->collision_state == VEHICLE_COLLISION;
        faults.laneless += car->current_lane_idx == -1;
        car->width /= scale;
        car->length /= scale;
    }
    return faults;
}

static void take_random_steps(Drive *env, int steps) {
    int (*actions)[2] = (int (*)[2])env->actions;
    for (int step = 0; step < steps; step++) {
        for (int car = 0; car < env->active_agent_count; car++) {
            actions[car][0] = rand() % ACCELERATIONS;
            actions[car][1] = rand() % STEERINGS;
        }
        c_step(env);
    }
}

int main(int count, char **arguments) {
    for (int i = 2; i < count; i++) {
        Drive env;
        start(&env, arguments[i]);
        printf("{");
        print_links(&env);
        print_cars(&env);
        Faults shrunk = find_faults(&env, 1), full = find_faults(&env, 1 / SHRUNK);
        printf(", \"shrunk\": [%d, %d, %d], \"full\": [%d, %d, %d]}\n", shrunk.off_road, shrunk.touching,
               shrunk.laneless, full.off_road, full.touching, full.laneless);
        take_random_steps(&env, atoi(arguments[1]));
        free_allocated(&env);
    }
    return 0;
}
