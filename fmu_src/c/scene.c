/* resources/model.bin: the scene as flat arrays. fmu_src/model_bin.py writes it and describes the format. */
#include "instance.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    char magic[8];
    uint64_t layout;
    uint64_t bytes;
    uint64_t checksum; /* of everything after it */
    char guid[64];
    uint64_t variable_count;
    uint64_t names_bytes;
    Sizes sizes;
    double start_time;
} Header;

/* FNV-1a over little-endian 64-bit words; every change of one word changes it. */
uint64_t checksum(const void *memory, size_t bytes)
{
    uint64_t hash = 0xcbf29ce484222325u;
    const unsigned char *at = memory;
    for (size_t i = 0; i + 8 <= bytes; i += 8) {
        uint64_t word;
        memcpy(&word, at + i, 8);
        hash = (hash ^ word) * 0x100000001b3u;
    }
    return hash;
}

const char *variable_name(const Scene *scene, const Variable *variable) { return scene->names + variable->name; }

/* Begin of the next `count` items of `size` bytes, 8-byte aligned; NULL if they do not fit. */
static const void *take(const Header *header, uint64_t *at, uint64_t count, uint64_t size)
{
    uint64_t left = header->bytes - *at;
    if (count > left / size)
        return NULL;
    uint64_t bytes = (count * size + 7) / 8 * 8;
    if (bytes > left)
        return NULL;
    const void *begin = (const unsigned char *)header + *at;
    *at += bytes;
    return begin;
}

static bool spans_fit(const Scene *scene)
{
    static const unsigned char blocks[TC_FIELDS] = {TC_FIELD_BLOCKS};
    const uint64_t *sizes = &scene->sizes.model_index;
    for (int i = 0; i < TC_FIELDS; i++)
        if (scene->spans[2 * i] > scene->spans[2 * i + 1] || scene->spans[2 * i + 1] > sizes[blocks[i]])
            return false;
    /* The kernels leave the figures of a status here. */
    return scene->spans[2 * TC_FIELD_DETAIL + 1] - scene->spans[2 * TC_FIELD_DETAIL] >= 2;
}

static bool variables_fit(const Scene *scene, uint64_t names_bytes)
{
    if (names_bytes > 0 && scene->names[names_bytes - 1] != '\0')
        return false;
    const uint64_t sizes[BLOCK_COUNT] = {scene->sizes.parameters, scene->sizes.inputs, scene->sizes.outputs};
    for (uint64_t i = 0; i < scene->variable_count; i++) {
        const Variable *v = &scene->variables[i];
        if (v->block >= BLOCK_COUNT || v->slot >= sizes[v->block] || v->name >= names_bytes)
            return false;
    }
    return true;
}

static bool parse(Scene *scene, size_t bytes, char *why, size_t why_size)
{
    const Header *header = scene->memory;
    if (bytes < sizeof *header || memcmp(header->magic, TC_MODEL_MAGIC, 8) != 0) {
        snprintf(why, why_size, "resources/model.bin is not a model of this product. Build the FMU again");
        return false;
    }
    if (header->layout != TC_LAYOUT_HASH) {
        snprintf(why, why_size,
                 "resources/model.bin has the layout %016llx and this library reads %016llx: they come from different "
                 "versions. Build the FMU again, do not mix files of two FMUs",
                 (unsigned long long)header->layout, (unsigned long long)TC_LAYOUT_HASH);
        return false;
    }
    const unsigned char *rest = (const unsigned char *)header + offsetof(Header, guid);
    if (header->bytes != bytes || bytes % 8 != 0 ||
        header->checksum != checksum(rest, bytes - offsetof(Header, guid))) {
        snprintf(why, why_size,
                 "resources/model.bin is damaged (%llu bytes, %llu expected; or its checksum differs). Unpack the FMU "
                 "again",
                 (unsigned long long)bytes, (unsigned long long)header->bytes);
        return false;
    }
    scene->guid = header->guid;
    scene->variable_count = header->variable_count;
    scene->sizes = header->sizes;
    scene->start_time = header->start_time;
    const Sizes *sizes = &scene->sizes;

    uint64_t at = sizeof *header;
    scene->variables = take(header, &at, header->variable_count, sizeof(Variable));
    scene->names = take(header, &at, header->names_bytes, 1);
    scene->spans = take(header, &at, 2 * TC_FIELDS, 8);
    uint64_t start = at;
    bool persists = take(header, &at, sizes->parameters, 8) && take(header, &at, sizes->inputs, 8) &&
                    take(header, &at, sizes->outputs, 8) && take(header, &at, sizes->state_real, 8) &&
                    take(header, &at, sizes->state_index, 4);
    scene->start = (const unsigned char *)header + start;
    scene->start_bytes = (size_t)(at - start);
    scene->model_real = take(header, &at, sizes->model_real, 8);
    scene->model_index = take(header, &at, sizes->model_index, 4);

    const uint64_t scratch_most = UINT64_C(1) << 40; /* it is not in the file, so nothing else bounds it */
    bool whole = scene->variables != NULL && scene->names != NULL && scene->spans != NULL && persists &&
                 scene->model_real != NULL && scene->model_index != NULL && at == bytes &&
                 sizes->scratch_real < scratch_most && sizes->scratch_index < scratch_most &&
                 header->guid[sizeof header->guid - 1] == '\0';
    if (!whole || !spans_fit(scene) || !variables_fit(scene, header->names_bytes)) {
        snprintf(why, why_size, "resources/model.bin contradicts itself. Build the FMU again");
        return false;
    }
    return true;
}

/* Read a scene; on failure say why and leave nothing behind. */
bool scene_load(Scene *scene, const char *location, char *why, size_t why_size)
{
    size_t bytes = 0;
    scene->memory = read_resource(location, "model.bin", &bytes, why, why_size);
    if (scene->memory == NULL)
        return false;
    if (parse(scene, bytes, why, why_size))
        return true;
    free(scene->memory);
    scene->memory = NULL;
    return false;
}
