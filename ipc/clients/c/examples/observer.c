/* Watches a controller: prints its cycles as they come, and a summary.
 *
 *     ./observer [DOMAIN [CYCLES [SECONDS]]]
 *
 * DOMAIN: directory of the domain, - for /tmp/vpc-<uid>. Ends after CYCLES cycles [100] or SECONDS [10]. Exit code 0:
 * all of them came. */
#define _POSIX_C_SOURCE 200809L /* nanosleep */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "vpc.h"

static int complain(const char *what) {
    fprintf(stderr, "observer: %s: %s\n", what, vpc_message());
    return 2;
}

int main(int count, char **words) {
    const char *directory = count > 1 && strcmp(words[1], "-") != 0 ? words[1] : NULL;
    const long wanted = count > 2 ? atol(words[2]) : 100;
    const double seconds = count > 3 ? atof(words[3]) : 10.0;

    vpc_domain *domain = NULL;
    vpc_observer *observer = NULL;
    if (vpc_domain_join(directory, &domain) != VPC_STATUS_OK) return complain("joining");
    if (vpc_observer_open(domain, &observer) != VPC_STATUS_OK) return complain("opening the ports");
    /* Receiving connects: messages of a publisher that ended before the first call are lost. */
    vpc_cycle_record cycle;
    uint64_t missed = 0, lost = 0, slowest_ns = 0;
    long cycles = 0;
    const uint64_t end = vpc_now_ns() + (uint64_t)(1e9 * seconds);
    printf("watching\n");
    fflush(stdout);
    while (cycles < wanted && vpc_now_ns() < end) {
        const vpc_status status = vpc_observer_cycle(observer, VPC_TAKE_OLDEST, &cycle, &missed);
        if (status == VPC_STATUS_NOTHING) {
            const struct timespec pause = {0, 1000000};
            nanosleep(&pause, NULL);
            continue;
        }
        if (status == VPC_STATUS_INVALID) { /* a message that breaks the contract: the next one may be valid */
            complain("a message");
            continue;
        }
        if (status != VPC_STATUS_OK) return complain("receiving");
        cycles++;
        lost += missed;
        slowest_ns = cycle.step_ns > slowest_ns ? cycle.step_ns : slowest_ns;
        printf("cycle %" PRIu64 ": %s, %s, %s, law %.1f us, error %.2f px, twist", cycle.cycle,
               vpc_state_name(cycle.state), vpc_hold_name(cycle.hold), vpc_strategy_name(cycle.strategy),
               1e-3 * (double)cycle.step_ns, cycle.error_px);
        for (int k = 0; k < 6; k++) {
            printf(" %g", cycle.twist[k]);
        }
        printf("\n");
    }
    printf("%ld cycles, %" PRIu64 " missed, slowest law %.1f us\n", cycles, lost, 1e-3 * (double)slowest_ns);
    vpc_observer_close(observer);
    vpc_domain_leave(domain);
    return cycles == wanted ? 0 : 1;
}
