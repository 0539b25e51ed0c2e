/* Commands a controller.
 *
 *     ./operator DOMAIN status|arm|disarm|stop|previous|knn|gpr|ibvs [VETO|NEIGHBOURS]
 *
 * DOMAIN: directory of the domain, - for /tmp/vpc-<uid>. VETO: arms in spite of that stop or disarm, which a refusal tells. Exit code 0: done, 1: refused, 2: no answer. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "vpc.h"

static const char *ACTIONS[] = {"status", "arm", "disarm", "stop"};

int main(int count, char **words) {
    if (count < 3) {
        fprintf(stderr, "operator: DOMAIN status|arm|disarm|stop|previous|knn|gpr|ibvs [VETO|NEIGHBOURS]\n");
        return 2;
    }
    uint32_t action = VPC_ACTION_STRATEGY, strategy = 0, number = count > 3 ? (uint32_t)strtoul(words[3], NULL, 10) : 0;
    for (uint32_t code = 0; code < 4; code++) {
        if (strcmp(words[2], ACTIONS[code]) == 0) action = code;
    }
    if (action == VPC_ACTION_STRATEGY) {
        while (strategy <= VPC_STRATEGY_IBVS && strcmp(words[2], vpc_strategy_name(strategy)) != 0) strategy++;
    }

    vpc_domain *domain = NULL;
    vpc_operator *operator_ = NULL;
    vpc_reply reply;
    vpc_status status = vpc_domain_join(strcmp(words[1], "-") != 0 ? words[1] : NULL, &domain);
    if (status == VPC_STATUS_OK) status = vpc_operator_open(domain, &operator_);
    if (status == VPC_STATUS_OK && action == VPC_ACTION_ARM) {
        status = vpc_arm_despite(operator_, number, &reply);
    } else if (status == VPC_STATUS_OK) {
        status = vpc_operator_ask(operator_, action, strategy, number, 2000000000u, &reply);
    }
    if (status == VPC_STATUS_OK || status == VPC_STATUS_REFUSED) {
        printf("%s; now %s (%s), %s\n", vpc_outcome_name(reply.outcome), vpc_state_name(reply.state),
               vpc_hold_name(reply.hold), vpc_strategy_name(reply.strategy));
        if (reply.outcome == VPC_OUTCOME_VETOED) printf("to arm all the same: arm %u\n", reply.veto);
    } else {
        fprintf(stderr, "operator: %s\n", vpc_message());
    }
    vpc_operator_close(operator_);
    vpc_domain_leave(domain);
    return status == VPC_STATUS_OK ? 0 : status == VPC_STATUS_REFUSED ? 1 : 2;
}
