/* Images over shared memory: a camera that sends a moving bar, or a program that looks at what a camera sends.
 *
 *     ./image [DOMAIN [send|watch [IMAGES [SECONDS]]]]
 *
 * DOMAIN: directory of the domain, - for /tmp/vpc-<uid>. Ends after IMAGES images [100] or SECONDS [10]. Exit code 0: all of
 * them were sent, or came. */
#define _POSIX_C_SOURCE 200809L /* nanosleep */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "vpc.h"

enum { WIDTH = 640, HEIGHT = 480, BAR = 32 };
static const uint64_t EXPOSURE_NS = 4000000u;

static int complain(const char *what) {
    fprintf(stderr, "image: %s: %s\n", what, vpc_message());
    return 2;
}

static void pause_ms(long ms) {
    const struct timespec pause = {0, 1000000 * ms};
    nanosleep(&pause, NULL);
}

/* 30 images a second: black, with a white bar that moves to the right. */
static int send(vpc_domain *domain, long images) {
    vpc_image_publisher *publisher = NULL;
    if (vpc_image_publisher_open(domain, (size_t)WIDTH * HEIGHT, &publisher) != VPC_STATUS_OK) {
        return complain("opening the publisher");
    }
    vpc_image_header header = {0};
    header.width = WIDTH, header.height = HEIGHT, header.stride = WIDTH, header.encoding = VPC_ENCODING_MONO8;
    for (long k = 0; k < images; k++) {
        uint8_t *pixels = NULL;
        if (vpc_image_loan(publisher, &header, &pixels) != VPC_STATUS_OK) return complain("loaning an image");
        header.exposure_begin_ns = vpc_now_ns();
        header.exposure_ns = EXPOSURE_NS;
        header.stamp.data_ns = header.exposure_begin_ns + EXPOSURE_NS / 2;
        memset(pixels, 0, (size_t)WIDTH * HEIGHT);
        for (int row = 0; row < HEIGHT; row++) {
            memset(pixels + (size_t)row * WIDTH + 8 * k % (WIDTH - BAR), 255, BAR);
        }
        pause_ms(33);
        if (vpc_image_send(publisher, &header, NULL) != VPC_STATUS_OK) return complain("sending an image");
    }
    printf("%ld images sent\n", images);
    vpc_image_publisher_close(publisher);
    return 0;
}

static double mean_of(const vpc_image_header *header, const uint8_t *pixels) {
    const uint32_t pixel = header->encoding == VPC_ENCODING_MONO8 ? 1 : header->encoding == VPC_ENCODING_YUYV ? 2 : 3;
    double sum = 0.0;
    for (uint32_t row = 0; row < header->height; row++) {
        for (uint32_t k = 0; k < header->width * pixel; k++) {
            sum += pixels[(size_t)row * header->stride + k];
        }
    }
    return sum / ((double)header->height * header->width * pixel);
}

static int watch(vpc_domain *domain, long wanted, double seconds) {
    vpc_image_subscriber *subscriber = NULL;
    if (vpc_image_subscriber_open(domain, &subscriber) != VPC_STATUS_OK) return complain("opening the subscriber");
    printf("watching\n");
    fflush(stdout);
    const uint64_t end = vpc_now_ns() + (uint64_t)(1e9 * seconds);
    long images = 0;
    uint64_t lost = 0;
    while (images < wanted && vpc_now_ns() < end) {
        vpc_image_header header;
        const uint8_t *pixels = NULL;
        uint64_t missed = 0;
        const vpc_status status = vpc_image_newest(subscriber, &header, &pixels, &missed);
        if (status == VPC_STATUS_NOTHING) {
            pause_ms(1);
            continue;
        }
        if (status == VPC_STATUS_INVALID) { /* an image that breaks the contract: the next one may be valid */
            complain("an image");
            continue;
        }
        if (status != VPC_STATUS_OK) return complain("receiving");
        images++;
        lost += missed;
        printf("image %" PRIu64 ": %" PRIu32 " x %" PRIu32 " %s, exposed for %.1f ms, mean %.2f\n", header.stamp.sequence,
               header.width, header.height, vpc_encoding_name(header.encoding), 1e-6 * (double)header.exposure_ns,
               mean_of(&header, pixels));
        fflush(stdout);
        vpc_image_release(subscriber);
    }
    printf("%ld images, %" PRIu64 " missed\n", images, lost);
    vpc_image_subscriber_close(subscriber);
    return images == wanted ? 0 : 1;
}

int main(int count, char **words) {
    const char *directory = count > 1 && strcmp(words[1], "-") != 0 ? words[1] : NULL;
    const int sends = count > 2 && strcmp(words[2], "send") == 0;
    const long images = count > 3 ? atol(words[3]) : 100;
    const double seconds = count > 4 ? atof(words[4]) : 10.0;

    vpc_domain *domain = NULL;
    if (vpc_domain_join(directory, &domain) != VPC_STATUS_OK) return complain("joining");
    const int code = sends ? send(domain, images) : watch(domain, images, seconds);
    vpc_domain_leave(domain);
    return code;
}
