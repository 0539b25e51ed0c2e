/* Wants a swing of the camera to the right and back, at 10 Hz; vpcd with `strategy = "follow"`
 * sends the nearest allowed twists.
 *
 *     ./policy [DOMAIN [SECONDS]]
 *
 * DOMAIN: directory of the domain, - for /tmp/vpc-<uid>. SECONDS: how long, 10 by default. */
#define _POSIX_C_SOURCE 200809L /* nanosleep */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "vpc.h"

#define PERIOD_NS 100000000
/* A twist counts for longer than a period, so that a late one does no harm. */
#define VALID_NS 200000000

int main(int count, char **words) {
    const char *place = count > 1 && strcmp(words[1], "-") != 0 ? words[1] : NULL;
    double seconds = count > 2 ? atof(words[2]) : 10.0;
    vpc_domain *domain = NULL;
    vpc_policy *policy = NULL;
    vpc_status status = vpc_domain_join(place, &domain);
    if (status == VPC_STATUS_OK) status = vpc_policy_open(domain, &policy);
    int wanted = 0;
    for (; status == VPC_STATUS_OK && wanted < 10.0 * seconds; wanted++) {
        /* vx vy vz wx wy wz, m/s and rad/s, camera frame: x right, y down, z forward */
        double twist[6] = {0.05 * sin(0.1 * wanted), 0, 0, 0, 0, 0};
        status = vpc_policy_want(policy, (const double(*)[6])&twist, vpc_now_ns() + VALID_NS);
        nanosleep(&(struct timespec){.tv_nsec = PERIOD_NS}, NULL);
    }
    if (status == VPC_STATUS_OK) {
        printf("%d twists were wanted\n", wanted);
    } else {
        fprintf(stderr, "policy: %s\n", vpc_message());
    }
    vpc_policy_close(policy);
    vpc_domain_leave(domain);
    return status == VPC_STATUS_OK ? 0 : 1;
}
