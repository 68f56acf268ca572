/* Functions of FMI 3.0 that this unit has no use for; importers load them all the same. They look at no argument, so
   they are declared without any, and say that they have failed. */

#include "fmi3.h"

#define ABSENT(name)             \
    FMI3_Export int name(void);  \
    FMI3_Export int name(void)   \
    {                            \
        return fmi3Error;        \
    }
#define NOTHING(name)             \
    FMI3_Export void *name(void); \
    FMI3_Export void *name(void)  \
    {                             \
        return 0;                 \
    }

NOTHING(fmi3InstantiateModelExchange)
NOTHING(fmi3InstantiateScheduledExecution)
ABSENT(fmi3ActivateModelPartition)
ABSENT(fmi3CompletedIntegratorStep)
ABSENT(fmi3EnterConfigurationMode)
ABSENT(fmi3EnterContinuousTimeMode)
ABSENT(fmi3EnterEventMode)
ABSENT(fmi3EnterStepMode)
ABSENT(fmi3EvaluateDiscreteStates)
ABSENT(fmi3ExitConfigurationMode)
ABSENT(fmi3GetAdjointDerivative)
ABSENT(fmi3GetBinary)
ABSENT(fmi3GetClock)
ABSENT(fmi3GetContinuousStateDerivatives)
ABSENT(fmi3GetContinuousStates)
ABSENT(fmi3GetDirectionalDerivative)
ABSENT(fmi3GetEventIndicators)
ABSENT(fmi3GetFloat32)
ABSENT(fmi3GetInt16)
ABSENT(fmi3GetInt64)
ABSENT(fmi3GetInt8)
ABSENT(fmi3GetIntervalDecimal)
ABSENT(fmi3GetIntervalFraction)
ABSENT(fmi3GetNominalsOfContinuousStates)
ABSENT(fmi3GetNumberOfContinuousStates)
ABSENT(fmi3GetNumberOfEventIndicators)
ABSENT(fmi3GetNumberOfVariableDependencies)
ABSENT(fmi3GetOutputDerivatives)
ABSENT(fmi3GetShiftDecimal)
ABSENT(fmi3GetShiftFraction)
ABSENT(fmi3GetString)
ABSENT(fmi3GetUInt16)
ABSENT(fmi3GetUInt32)
ABSENT(fmi3GetUInt64)
ABSENT(fmi3GetUInt8)
ABSENT(fmi3GetVariableDependencies)
ABSENT(fmi3SetBinary)
ABSENT(fmi3SetClock)
ABSENT(fmi3SetContinuousStates)
ABSENT(fmi3SetFloat32)
ABSENT(fmi3SetInt16)
ABSENT(fmi3SetInt32)
ABSENT(fmi3SetInt64)
ABSENT(fmi3SetInt8)
ABSENT(fmi3SetIntervalDecimal)
ABSENT(fmi3SetIntervalFraction)
ABSENT(fmi3SetShiftDecimal)
ABSENT(fmi3SetShiftFraction)
ABSENT(fmi3SetString)
ABSENT(fmi3SetTime)
ABSENT(fmi3SetUInt16)
ABSENT(fmi3SetUInt32)
ABSENT(fmi3SetUInt64)
ABSENT(fmi3SetUInt8)
ABSENT(fmi3UpdateDiscreteStates)
