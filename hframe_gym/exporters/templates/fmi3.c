/*
 * Co-simulation of a stage by FMI 3.0: the integrator of hframe_gym around the functions of the machine in model.c.
 *
 * One step of length h, from the belt travel p and the speed v of each coordinate, with constant voltages:
 *
 *   1. half-way point    p1 = p + h/2 v; the forces f1 and F1 (Coulomb friction) there give the acceleration a
 *   2. corrected point   p2 = p1 + h^2/12 a, with the mean speed v + h/2 a; forces f2 and F2
 *   3. exact flow        m dv/dt = f2 - b v - F2 sign v over h, through a stop, gives v and p
 *   4. effect states     states of the effects of the machine after h
 *
 * Units: m, m/s, N, kg, s, V; f contains all forces but viscous friction b v and Coulomb friction F.
 */
#include "fmi3Functions.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"
#include "sizes.h"

typedef struct {
    double time;
    double voltage[DRIVES];
    double start[AXES]; /* position of the stage's tool at the start, m */
    double travel[COORDINATES];
    double speed[COORDINATES];
    double effect_state[EFFECT_STATES + 1]; /* at least one entry, as C requires */
} Stage;

static double limited(double value, double limit)
{
    return fmax(fmin(value, limit), -limit);
}

/* Coulomb friction force; at rest it equals the force f, up to the limit F. */
static double coulomb_friction(double v, double f, double F)
{
    return v == 0.0 ? limited(f, F) : copysign(F, v);
}

/* Whether a coordinate moves backward or, at rest, the force on it points backward: index in a row of VISCOUS. */
static int is_backward(double v, double f)
{
    return copysign(1.0, v == 0.0 ? f : v) < 0.0;
}

/* Speed after the time t of m dv/dt = net - b v from the speed v, and the distance traveled. */
static void viscous_flow(double v, double net, double b, double m, double t, double *speed, double *traveled)
{
    const double z = b * t / m;
    double mean = 0.0; /* (1 - exp(-z)) / z */
    double ramp = 0.0; /* (z - 1 + exp(-z)) / z^2 */
    if (z < 0.5) { /* series, because the closed forms cancel */
        double term = 1.0;
        int k;
        for (k = 0; k < 16; k++) { /* term = (-z)^k / (k + 1)! */
            mean += term;
            ramp += term / (k + 2);
            term *= -z / (k + 2);
        }
    } else {
        mean = (1.0 - exp(-z)) / z;
        ramp = (z - 1.0 + exp(-z)) / (z * z);
    }
    *speed = v * exp(-z) + net * t / m * mean;
    *traveled = v * t * mean + net * t * t / m * ramp;
}

/*
 * Speed after the time h of m dv/dt = f - b v - F sign v from the speed v, and the distance traveled. A coordinate that
 * stops rests then, or leaves in the direction of f. viscous: b in the direction of motion, and in the opposite one.
 */
static void flow(double v, double f, double F, const double viscous[2], double m, double h, double *speed,
                 double *traveled)
{
    const double net = f - coulomb_friction(v, f, F);
    const double b = viscous[0];
    double time_to_stop, traveled_to_stop, no_speed;
    viscous_flow(v, net, b, m, h, speed, traveled);
    if (*speed * v >= 0.0)
        return;
    time_to_stop = b != 0.0 ? m / b * log1p(-b * v / net) : -m * v / net;
    viscous_flow(v, net, b, m, time_to_stop, &no_speed, &traveled_to_stop);
    viscous_flow(0.0, f - limited(f, F), viscous[1], m, h - time_to_stop, speed, traveled);
    *traveled += traveled_to_stop;
}

static void step(Stage *s, double h)
{
    double half_way_travel[COORDINATES], correction[COORDINATES], mean_speed[COORDINATES], traveled[COORDINATES];
    double force[COORDINATES], coulomb[COORDINATES], effect_input[EFFECT_INPUTS + 1];
    const double time = s->time + 0.5 * h;
    int i;

    for (i = 0; i < COORDINATES; i++)
        half_way_travel[i] = s->travel[i] + 0.5 * h * s->speed[i];
    model_forces_at_half_way_point(time, half_way_travel, s->speed, s->effect_state, 0.5 * h, s->voltage, force,
                                   coulomb);
    for (i = 0; i < COORDINATES; i++) {
        const double v = s->speed[i], f = force[i];
        const double b = VISCOUS[i][is_backward(v, f)];
        const double a = (f - b * v - coulomb_friction(v, f, coulomb[i])) / MASS[i];
        correction[i] = h * h / 12.0 * a;
        mean_speed[i] = v + 0.5 * h * a;
    }

    model_forces_at_corrected_point(time, half_way_travel, correction, mean_speed, s->effect_state, 0.5 * h,
                                    s->voltage, force, coulomb, effect_input);
    for (i = 0; i < COORDINATES; i++) {
        const double v = s->speed[i], f = force[i];
        const int backward = is_backward(v, f);
        const double viscous[2] = {VISCOUS[i][backward], VISCOUS[i][!backward]};
        flow(v, f, coulomb[i], viscous, MASS[i], h, &s->speed[i], &traveled[i]);
        s->travel[i] += traveled[i];
    }

    model_next_effect_state(s->effect_state, effect_input, traveled, mean_speed, h);
    s->time += h;
}

/* Places the stage at its start, at rest with unstretched belts. */
static void rest_at_start(Stage *s)
{
    int i, k;
    for (i = 0; i < COORDINATES; i++) {
        s->travel[i] = s->speed[i] = 0.0;
        for (k = 0; k < AXES; k++)
            s->travel[i] += TRAVEL_PER_AXIS[i][k] * s->start[k];
    }
    memset(s->effect_state, 0, sizeof s->effect_state);
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    (void)instance; (void)loggingOn; (void)nCategories; (void)categories;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
    fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
    fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate)
{
    (void)instanceName; (void)resourcePath; (void)visible; (void)loggingOn; (void)eventModeUsed;
    (void)earlyReturnAllowed; (void)requiredIntermediateVariables; (void)nRequiredIntermediateVariables;
    (void)instanceEnvironment; (void)logMessage; (void)intermediateUpdate;
    if (instantiationToken == NULL || strcmp(instantiationToken, INSTANTIATION_TOKEN) != 0)
        return NULL;
    return calloc(1, sizeof(Stage));
}

void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    (void)toleranceDefined; (void)tolerance; (void)stopTimeDefined; (void)stopTime;
    ((Stage *)instance)->time = startTime;
    rest_at_start(instance);
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    rest_at_start(instance);
    return fmi3OK;
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    (void)instance;
    return fmi3OK;
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    (void)instance;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    (void)instance;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    memset(instance, 0, sizeof(Stage));
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues)
{
    Stage *s = instance;
    double readings[SENSORS];
    size_t k;
    if (nValues != nValueReferences)
        return fmi3Error;
    model_sensors(s->travel, readings);
    for (k = 0; k < nValues; k++) {
        const fmi3ValueReference r = valueReferences[k];
        if (r == 0)
            values[k] = s->time;
        else if (r >= FIRST_INPUT && r < FIRST_INPUT + DRIVES)
            values[k] = s->voltage[r - FIRST_INPUT];
        else if (r >= FIRST_OUTPUT && r < FIRST_OUTPUT + SENSORS)
            values[k] = readings[r - FIRST_OUTPUT];
        else if (r >= FIRST_START && r < FIRST_START + AXES)
            values[k] = s->start[r - FIRST_START];
        else
            return fmi3Error;
    }
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues)
{
    Stage *s = instance;
    size_t k;
    if (nValues != nValueReferences)
        return fmi3Error;
    for (k = 0; k < nValues; k++) {
        const fmi3ValueReference r = valueReferences[k];
        if (r >= FIRST_INPUT && r < FIRST_INPUT + DRIVES) {
            s->voltage[r - FIRST_INPUT] = values[k];
        } else if (r >= FIRST_START && r < FIRST_START + AXES) {
            s->start[r - FIRST_START] = values[k];
            rest_at_start(s);
        } else {
            return fmi3Error;
        }
    }
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    Stage *s = instance;
    const int steps = (int)ceil(communicationStepSize / LONGEST_STEP - 1e-9);
    int k;
    (void)noSetFMUStatePriorToCurrentPoint;
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    for (k = 0; k < steps; k++)
        step(s, communicationStepSize / steps);
    s->time = currentCommunicationPoint + communicationStepSize;
    *lastSuccessfulTime = s->time;
    for (k = 0; k < COORDINATES; k++)
        if (!isfinite(s->travel[k]))
            return fmi3Error;
    return fmi3OK;
}

/* Functions of FMI 3.0 that a co-simulation without events, clocks and other types of variables does not support. */

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage)
{
    (void)instanceName; (void)instantiationToken; (void)resourcePath; (void)visible; (void)loggingOn; (void)instanceEnvironment; (void)logMessage;
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment, fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate, fmi3LockPreemptionCallback lockPreemption, fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName; (void)instantiationToken; (void)resourcePath; (void)visible; (void)loggingOn; (void)instanceEnvironment; (void)logMessage; (void)clockUpdate; (void)lockPreemption; (void)unlockPreemption;
    return NULL;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    (void)instance;
    return fmi3Error;
}

fmi3Status fmi3GetFloat32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Float32 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetInt8(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Int8 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetUInt8(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3UInt8 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetInt16(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Int16 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetUInt16(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3UInt16 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Int32 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetUInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3UInt32 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Int64 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetUInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3UInt64 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Boolean values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3String values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)valueSizes; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Clock values[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values;
    return fmi3Error;
}

fmi3Status fmi3SetFloat32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Float32 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetInt8(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Int8 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetUInt8(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3UInt8 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetInt16(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Int16 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetUInt16(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3UInt16 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Int32 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetUInt32(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3UInt32 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Int64 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetUInt64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3UInt64 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Boolean values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3String values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)valueSizes; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Clock values[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)values;
    return fmi3Error;
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference, size_t* nDependencies)
{
    (void)instance; (void)valueReference; (void)nDependencies;
    return fmi3Error;
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent, size_t elementIndicesOfDependent[], fmi3ValueReference independents[], size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[], size_t nDependencies)
{
    (void)instance; (void)dependent; (void)elementIndicesOfDependent; (void)independents; (void)elementIndicesOfIndependents; (void)dependencyKinds; (void)nDependencies;
    return fmi3Error;
}

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState* FMUState)
{
    (void)instance; (void)FMUState;
    return fmi3Error;
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    (void)instance; (void)FMUState;
    return fmi3Error;
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState* FMUState)
{
    (void)instance; (void)FMUState;
    return fmi3Error;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t* size)
{
    (void)instance; (void)FMUState; (void)size;
    return fmi3Error;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    (void)instance; (void)FMUState; (void)serializedState; (void)size;
    return fmi3Error;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size, fmi3FMUState* FMUState)
{
    (void)instance; (void)serializedState; (void)size; (void)FMUState;
    return fmi3Error;
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    (void)instance; (void)unknowns; (void)nUnknowns; (void)knowns; (void)nKnowns; (void)seed; (void)nSeed; (void)sensitivity; (void)nSensitivity;
    return fmi3Error;
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns, const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    (void)instance; (void)unknowns; (void)nUnknowns; (void)knowns; (void)nKnowns; (void)seed; (void)nSeed; (void)sensitivity; (void)nSensitivity;
    return fmi3Error;
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)intervals; (void)qualifiers;
    return fmi3Error;
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[], fmi3IntervalQualifier qualifiers[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)counters; (void)resolutions; (void)qualifiers;
    return fmi3Error;
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3Float64 shifts[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)shifts;
    return fmi3Error;
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)counters; (void)resolutions;
    return fmi3Error;
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Float64 intervals[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)intervals;
    return fmi3Error;
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)counters; (void)resolutions;
    return fmi3Error;
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Float64 shifts[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)shifts;
    return fmi3Error;
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)counters; (void)resolutions;
    return fmi3Error;
}

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    (void)instance;
    return fmi3Error;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean* discreteStatesNeedUpdate, fmi3Boolean* terminateSimulation, fmi3Boolean* nominalsOfContinuousStatesChanged, fmi3Boolean* valuesOfContinuousStatesChanged, fmi3Boolean* nextEventTimeDefined, fmi3Float64* nextEventTime)
{
    (void)instance; (void)discreteStatesNeedUpdate; (void)terminateSimulation; (void)nominalsOfContinuousStatesChanged; (void)valuesOfContinuousStatesChanged; (void)nextEventTimeDefined; (void)nextEventTime;
    return fmi3Error;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    (void)instance;
    return fmi3Error;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean* enterEventMode, fmi3Boolean* terminateSimulation)
{
    (void)instance; (void)noSetFMUStatePriorToCurrentPoint; (void)enterEventMode; (void)terminateSimulation;
    return fmi3Error;
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    (void)instance; (void)time;
    return fmi3Error;
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[], size_t nContinuousStates)
{
    (void)instance; (void)continuousStates; (void)nContinuousStates;
    return fmi3Error;
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[], size_t nContinuousStates)
{
    (void)instance; (void)derivatives; (void)nContinuousStates;
    return fmi3Error;
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators)
{
    (void)instance; (void)eventIndicators; (void)nEventIndicators;
    return fmi3Error;
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates)
{
    (void)instance; (void)continuousStates; (void)nContinuousStates;
    return fmi3Error;
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t nContinuousStates)
{
    (void)instance; (void)nominals; (void)nContinuousStates;
    return fmi3Error;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t* nEventIndicators)
{
    (void)instance; (void)nEventIndicators;
    return fmi3Error;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t* nContinuousStates)
{
    (void)instance; (void)nContinuousStates;
    return fmi3Error;
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    (void)instance;
    return fmi3Error;
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[], size_t nValues)
{
    (void)instance; (void)valueReferences; (void)nValueReferences; (void)orders; (void)values; (void)nValues;
    return fmi3Error;
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clockReference, fmi3Float64 activationTime)
{
    (void)instance; (void)clockReference; (void)activationTime;
    return fmi3Error;
}
